"""gsplat's functions on the processor: its own references in PyTorch in place of its kernels.

gsplat tests its kernels against these references. `rasterize_to_indices_in_range` has none: what is
here is written from its documentation, and the constants from its kernel.
"""

import pytest


def on_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have `cuda_views` work on the processor."""
    torch = pytest.importorskip("torch", reason="needs torch")
    gsplat = pytest.importorskip("gsplat", reason="needs gsplat")
    from gsplat.cuda import _torch_impl as reference

    from cogsplat.codec.render import cuda_views

    def fully_fused_projection(
        means, covars, quats, scales, viewmats, Ks, width, height, *, opacities, **options
    ):
        assert covars is None
        assert opacities.shape == means.shape[:1]
        covars, _ = reference._quat_scale_to_covar_preci(quats, scales, compute_preci=False)
        return reference._fully_fused_projection(
            means, covars, viewmats, Ks, width, height, **options
        )

    def rasterize_to_indices_in_range(
        range_start, range_end, transmittances, means2d, conics, opacities, image_width,
        image_height, tile_size, isect_offsets, flatten_ids,
    ):  # fmt: skip
        assert transmittances.shape == (1, image_height, image_width)
        assert opacities.shape == (1, means2d.shape[1])
        assert range_start == 0
        pairs = []
        offsets = [*isect_offsets.flatten().tolist(), len(flatten_ids)]
        tiles_x = isect_offsets.shape[-1]
        for y in range(image_height):
            for x in range(image_width):
                tile = y // tile_size * tiles_x + x // tile_size
                left = float(transmittances[0, y, x])
                members = flatten_ids[offsets[tile] : offsets[tile + 1]].long()
                dx, dy = (means2d[0, members] - torch.tensor([x + 0.5, y + 0.5])).unbind(1)
                a, b, c = conics[0, members].unbind(1)
                sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
                alpha = (opacities[0, members] * torch.exp(-sigma)).clamp(max=0.999)
                for splat, opaque in zip(members.tolist(), alpha.tolist(), strict=True):
                    if opaque < 1 / 255:
                        continue
                    left *= 1 - opaque
                    if left <= 1e-4:
                        break
                    pairs.append((splat, y * image_width + x, 0))
        columns = torch.tensor(pairs, dtype=torch.int64).reshape(-1, 3)
        return columns[:, 0], columns[:, 1], columns[:, 2]

    monkeypatch.setattr(gsplat, "fully_fused_projection", fully_fused_projection)
    monkeypatch.setattr(gsplat, "isect_tiles", reference._isect_tiles)
    monkeypatch.setattr(gsplat, "isect_offset_encode", reference._isect_offset_encode)
    monkeypatch.setattr(gsplat, "spherical_harmonics", reference._spherical_harmonics)
    monkeypatch.setattr(gsplat, "rasterize_to_indices_in_range", rasterize_to_indices_in_range)
    monkeypatch.setattr(cuda_views, "cuda_device", lambda: torch.device("cpu"))
