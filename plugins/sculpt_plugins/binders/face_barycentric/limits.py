"""Numbers that the torch code and the kernels have in common. Imports nothing, for the kernels' sake."""

SQUARE = 1e-12
"""Square of the shortest length that is told from zero, in object units squared."""
FLATTEST = 1.0
"""Curvature, per object unit, of the ball that fills the object's box: no rim is taken for flatter."""
NARROWEST = 0.02
"""Share of a Gaussian's deviation that trimming leaves at the least: less, and rounding shows in other directions."""
OF_A_SHEET = 0.4
"""Share of a sheet's thickness that Gaussians go below their face at the most: the two sides stay apart."""
FLAT = 1e-3
"""Sine of a bend that is no bend."""
TINY = 1e-20
"""Keeps quotients of squares finite."""
OPPOSITE = -0.5
"""Cosine between the normals of two faces that are taken for the two sides of a sheet."""
UNDECIDED = 0.7
"""Component of a normal along its second axis, relative to the first, from which its partner may go by that one."""
PLACE_BITS = 20
"""Steps along the object in which the faces of a column are ordered: as a power of two."""
LOG_LAYERS_FROM, LOG_LAYERS_TO, LOG_LAYERS_STEP = -1.0, 8.0, 0.125
"""Between which logarithms of the number of overlapping Gaussians the depth at a rim is tabled."""
