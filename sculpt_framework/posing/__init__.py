"""From a folder of photographs or a video to posed images: features, matches and mapping by pycolmap, on the CPU."""
