"""The CUDA kernels of the package gsplat, where that is installed."""
