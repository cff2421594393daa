"""Denoising as a camera does it: bilateral filter, median filter, wavelet coring."""

from jaxisp.stages.denoise import bilateral, median, wavelet

__all__ = ["bilateral", "median", "wavelet"]
