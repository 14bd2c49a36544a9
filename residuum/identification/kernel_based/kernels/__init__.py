"""Prior covariances of impulse responses, one file each."""

from residuum.identification.kernel_based.kernels.base import DiagonalKernel, Kernel
from residuum.identification.kernel_based.kernels.diagonal import Diagonal
from residuum.identification.kernel_based.kernels.diagonal_correlated import DiagonalCorrelated
from residuum.identification.kernel_based.kernels.stable_spline import StableSpline
from residuum.identification.kernel_based.kernels.tuned_correlated import TunedCorrelated

KERNELS: dict[str, Kernel] = {
    "tc": TunedCorrelated(),
    "dc": DiagonalCorrelated(),
    "ss": StableSpline(),
    "di": Diagonal(),
}

__all__ = ["KERNELS", "Diagonal", "DiagonalCorrelated", "DiagonalKernel", "Kernel", "StableSpline", "TunedCorrelated"]
