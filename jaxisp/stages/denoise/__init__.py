"""Denoising as a camera does it: bilateral, median and guided filters, non-local means, wavelet coring."""

from jaxisp.stages.denoise import bilateral, guided, median, nonlocal_means, wavelet

__all__ = ["bilateral", "guided", "median", "nonlocal_means", "wavelet"]
