"""Multi-view stereo: posed views in, a depth, a normal and a confidence per pixel out."""
