"""The NeRF-Synthetic layout: transforms_train.json and images with alpha, as Blender exporters write them."""
