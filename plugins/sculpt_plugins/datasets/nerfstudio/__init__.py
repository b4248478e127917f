"""transforms.json as nerfstudio's converters and instant-ngp's write it: one file, one camera per frame if need be."""
