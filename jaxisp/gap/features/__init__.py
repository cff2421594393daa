"""Features: statistics of the residual of clean+noisy pairs, and residual spectra of both kinds of pairs."""
