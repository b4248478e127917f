"""A first shape straight from the images, before anything is optimised: silhouettes, then agreement of colours."""
