"""Files in and out: RAW, JPEG, pictures and data sets. The only place that reads files; NumPy only."""

from jaxisp.io.datasets import Dataset, Loaded, Pair, open_dataset
from jaxisp.io.description import RawDescription
from jaxisp.io.dng import write_dng
from jaxisp.io.files import atomic_write, filled_folder, find_images, output_file, output_folder, read_toml
from jaxisp.io.images import read_image, write_png
from jaxisp.io.jpeg import Jpeg, read_jpeg, write_jpeg
from jaxisp.io.locks import locked
from jaxisp.io.opcodes import FixVignetteRadial, GainMap, WarpRectilinear
from jaxisp.io.orientation import orient, unorient
from jaxisp.io.raw import Raw, read_raw
from jaxisp.io.settings import Settings

__all__ = [
    "Dataset",
    "FixVignetteRadial",
    "GainMap",
    "Jpeg",
    "Loaded",
    "Pair",
    "Raw",
    "RawDescription",
    "Settings",
    "WarpRectilinear",
    "atomic_write",
    "filled_folder",
    "find_images",
    "locked",
    "open_dataset",
    "orient",
    "output_file",
    "output_folder",
    "read_image",
    "read_jpeg",
    "read_raw",
    "read_toml",
    "unorient",
    "write_dng",
    "write_jpeg",
    "write_png",
]
__dir__ = __all__.copy  # what an editor completes
