"""Gaussians to image, on CPU and CUDA from one kernel source in Dr.Jit, and how Gaussians are trained."""

import compose  # noqa: F401  (first: it points Dr.Jit to a good LLVM)
