"""L1 and D-SSIM."""
