"""Evaluation of scenes and files: PSNR, SSIM, LPIPS, prefixes, bytes, reports."""
