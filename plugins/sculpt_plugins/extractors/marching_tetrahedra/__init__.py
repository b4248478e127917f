"""Marching tetrahedra on a conforming split of the grid, on a narrow band."""
