"""Demosaicking: mosaic to camera RGB, and the median that cleans up after it.

Twelve algorithms for Bayer mosaics, Markesteijn's for X-Trans, and normalised convolution for both.
"""

from jaxisp.stages.demosaic.ahd import demosaic_ahd
from jaxisp.stages.demosaic.bilinear import demosaic_bilinear
from jaxisp.stages.demosaic.dcb import demosaic_dcb
from jaxisp.stages.demosaic.edge_aware import demosaic_edge_aware
from jaxisp.stages.demosaic.hamilton_adams import demosaic_hamilton_adams
from jaxisp.stages.demosaic.hibbard import demosaic_hibbard
from jaxisp.stages.demosaic.lmmse import demosaic_lmmse
from jaxisp.stages.demosaic.malvar import demosaic_malvar
from jaxisp.stages.demosaic.markesteijn import demosaic_markesteijn
from jaxisp.stages.demosaic.median import color_difference_median
from jaxisp.stages.demosaic.menon import demosaic_menon
from jaxisp.stages.demosaic.normalized_convolution import demosaic_normalized_convolution
from jaxisp.stages.demosaic.ppg import demosaic_ppg
from jaxisp.stages.demosaic.rcd import demosaic_rcd
from jaxisp.stages.demosaic.vng import demosaic_vng

__all__ = [
    "color_difference_median",
    "demosaic_ahd",
    "demosaic_bilinear",
    "demosaic_dcb",
    "demosaic_edge_aware",
    "demosaic_hamilton_adams",
    "demosaic_hibbard",
    "demosaic_lmmse",
    "demosaic_malvar",
    "demosaic_markesteijn",
    "demosaic_menon",
    "demosaic_normalized_convolution",
    "demosaic_ppg",
    "demosaic_rcd",
    "demosaic_vng",
]
