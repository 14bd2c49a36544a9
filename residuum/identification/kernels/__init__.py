"""Prior covariances of impulse responses, one file each."""

from residuum.identification.kernels.base import DiagonalKernel, Kernel
from residuum.identification.kernels.diagonal import Diagonal
from residuum.identification.kernels.diagonal_correlated import DiagonalCorrelated
from residuum.identification.kernels.stable_spline import StableSpline
from residuum.identification.kernels.tuned_correlated import TunedCorrelated

KERNELS: dict[str, Kernel] = {
    "tc": TunedCorrelated(),
    "dc": DiagonalCorrelated(),
    "ss": StableSpline(),
    "di": Diagonal(),
}

__all__ = ["KERNELS", "Diagonal", "DiagonalCorrelated", "DiagonalKernel", "Kernel", "StableSpline", "TunedCorrelated"]
