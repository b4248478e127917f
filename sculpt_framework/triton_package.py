"""Whether the package Triton is there, and new enough for the kernels that are written in it."""

from sculpt_framework.errors import ComponentImportError, first_line

_OLDEST = (3, 5)
"""Earlier ones know no products of matrices with eight columns."""


def require_triton(who: str, instead: str) -> None:
    """Raises ComponentImportError where it is missing, broken or too old, with who needs it and what else to do."""
    try:
        import triton

        version = tuple(int(part) for part in triton.__version__.split(".")[:2])
    except Exception as error:  # Whatever a broken installation raises.
        cause = first_line(error)
        raise ComponentImportError(
            f"{who} needs the package triton, which cannot be imported ({cause}). It comes with torch for CUDA on "
            f"Linux: install that, or {instead}."
        ) from error
    if version < _OLDEST:
        raise ComponentImportError(
            f"{who} needs Triton {_OLDEST[0]}.{_OLDEST[1]} or later, but this is {triton.__version__}. It comes with "
            f"torch for CUDA on Linux, 2.9 or later: install that, or {instead}."
        )
