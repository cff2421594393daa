"""Statistics of a picture's residual, and its spectra."""
