"""`isp_model` for trainers whose degradations are those of BSRGAN or Real-ESRGAN."""

from typing import Any

import numpy as np

from jaxisp.errors import InputError
from jaxisp.interop.process import Degrader, worker


class IspModel(Degrader):
    """What `degradation_bsrgan(img, isp_model=...)` asks for: `forward(img, hq)` gives a pair of pictures.

    Each call degrades the next picture: the n-th call of a worker has the same draws whatever else runs. A
    worker of a PyTorch loader has a stream of its own. Start workers with `multiprocessing_context="spawn"`.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._count = 0

    def forward(self, img: np.ndarray, hq: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray | None]:
        """Degrade a picture; its counterpart stays.

        Args:
            img: (H, W, 3) float encoded sRGB in [0, 1], in the order R, G, B.
            hq: passed on as it is.

        Returns:
            (H, W, 3) float32 in [0, 1], and `hq`.

        Raises:
            InputError: not such a picture, or a process in which JAX cannot run.
        """
        picture = np.asarray(img)
        if picture.ndim != 3 or picture.shape[-1] != 3 or picture.dtype.kind != "f":
            raise InputError(
                f"isp_model takes (H, W, 3) floats in [0, 1], got {picture.dtype}{picture.shape}"
            )
        key = self.key(worker())
        index = np.asarray([self._count], np.int32)
        self._count += 1
        # filters before it may have overshot
        return self.degrade(key, np.clip(picture, 0, 1).astype(np.float32)[None], index)[0], hq

    __call__ = forward
