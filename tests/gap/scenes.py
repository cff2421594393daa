"""Made-up scenes: blobs, edges and texture in colour, in Y'CbCr steps."""

import numpy as np


def scenes(rng, n=4, shape=(136, 152)):
    """(n, h, w, 3)."""
    h, w = shape
    spectrum = 1 / (np.hypot(np.fft.fftfreq(h)[:, None], np.fft.fftfreq(w)) + 0.02) ** 1.2
    out = []
    for _ in range(n):
        planes = [np.fft.ifft2(np.fft.fft2(rng.normal(size=shape)) * spectrum).real for _ in range(3)]
        planes = [p / p.std() for p in planes]
        patches = np.kron(rng.normal(size=(5, 5, 3)), np.ones((h // 5 + 1, w // 5 + 1, 1)))[:h, :w]
        luma = np.clip(120 + 35 * planes[0] + 30 * patches[..., 0], 8, 247)
        chroma = [10 * p + 14 * patches[..., c] for c, p in enumerate(planes[1:], 1)]
        out.append(np.stack([luma, *chroma], -1))
    return np.asarray(out, np.float32)
