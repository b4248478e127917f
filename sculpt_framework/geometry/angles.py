"""How far apart cameras stand."""

import numpy as np
from jaxtyping import Float, Float64


def angles_between(places: Float[np.ndarray, "v 3"]) -> Float64[np.ndarray, "v v"]:
    """Degrees between the directions in which places stand as seen from the origin; 90 from one that stands there."""
    directions = (places / np.maximum(np.linalg.norm(places, axis=1, keepdims=True), 1e-9)).astype(float)
    return np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
