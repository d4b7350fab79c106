"""A picture in float64 PyTorch, pixel by pixel over all splats, which PyTorch differentiates.

Written from the equations (Zwicker et al. 2001, Kerbl et al. 2023), sharing no code with codec.
"""

import math

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs torch")

ALPHA_MAX = float(np.float32(0.99))
STOP = float(np.float32(1e-4))


def sh_bases(directions, degree):
    """Real SH with the Condon-Shortley phase by their polynomials: (N, K)."""
    x, y, z = directions.unbind(1)
    root = math.sqrt
    pi = math.pi
    bases = [torch.full_like(x, root(1 / (4 * pi)))]
    if degree > 0:
        bases += [-root(3 / (4 * pi)) * y, root(3 / (4 * pi)) * z, -root(3 / (4 * pi)) * x]
    if degree > 1:
        bases += [
            root(15 / (4 * pi)) * x * y,
            -root(15 / (4 * pi)) * y * z,
            root(5 / (16 * pi)) * (2 * z**2 - x**2 - y**2),
            -root(15 / (4 * pi)) * x * z,
            root(15 / (16 * pi)) * (x**2 - y**2),
        ]
    if degree > 2:
        bases += [
            -root(35 / (32 * pi)) * y * (3 * x**2 - y**2),
            root(105 / (4 * pi)) * x * y * z,
            -root(21 / (32 * pi)) * y * (4 * z**2 - x**2 - y**2),
            root(7 / (16 * pi)) * z * (2 * z**2 - 3 * x**2 - 3 * y**2),
            -root(21 / (32 * pi)) * x * (4 * z**2 - x**2 - y**2),
            root(105 / (16 * pi)) * z * (x**2 - y**2),
            -root(35 / (32 * pi)) * x * (x**2 - 3 * y**2),
        ]
    return torch.stack(bases, dim=1)


def rotations(quats):
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


def picture(values, camera, added, *, background=(0, 0, 0), near=0.2):
    """Draw a dict of float64 tensors, named as in `Splats`: (H, W, 3).

    `added` holds the thickness and the filter of each splat, px², (N, 2).
    """
    turn = torch.from_numpy(camera.rotation)
    position = torch.from_numpy(camera.position)
    offset = values["means"] - position
    degree = math.isqrt(values["shN"].shape[1] + 1) - 1
    bases = sh_bases(offset / offset.norm(dim=1, keepdim=True), degree)
    coefficients = torch.cat([values["sh0"][:, None], values["shN"]], dim=1)
    colours = ((bases[:, :, None] * coefficients).sum(1) + 0.5).clamp(min=0)
    local = values["means"] @ turn.T + torch.from_numpy(camera.translation)
    x, y, z = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2], local[:, 2]
    guard_x, guard_y = (
        0.3 * side / 2 / focal
        for side, focal in ((camera.width, camera.fx), (camera.height, camera.fy))
    )
    in_x = x.clamp(
        -camera.cx / camera.fx - guard_x, (camera.width - camera.cx) / camera.fx + guard_x
    )
    in_y = y.clamp(
        -camera.cy / camera.fy - guard_y, (camera.height - camera.cy) / camera.fy + guard_y
    )
    nothing = torch.zeros_like(z)
    jacobian = torch.stack(
        [
            torch.stack([camera.fx / z, nothing, -camera.fx * in_x / z], dim=1),
            torch.stack([nothing, camera.fy / z, -camera.fy * in_y / z], dim=1),
        ],
        dim=1,
    )
    spread = jacobian @ turn @ rotations(values["quats"]) @ torch.diag_embed(values["scales"].exp())
    bare = spread @ spread.transpose(1, 2)
    eye = torch.eye(2, dtype=torch.float64)
    thickness, blur = (column[:, None, None] for column in torch.from_numpy(added).T)
    trained = bare + thickness * eye
    wide = trained + blur * eye
    factor = (torch.linalg.det(trained) / torch.linalg.det(wide)).sqrt()
    opacity = torch.sigmoid(values["opacities"])
    opacity = torch.where(blur[:, 0, 0] > 0, opacity * factor, opacity)
    centres = torch.stack([camera.fx * x + camera.cx, camera.fy * y + camera.cy], dim=1)
    lines, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    pixels = torch.from_numpy(np.stack([columns.ravel(), lines.ravel()], axis=1))
    offsets = pixels[None] - centres[:, None]
    square = torch.einsum("npi,nij,npj->np", offsets, torch.linalg.inv(wide), offsets)
    raw = opacity[:, None] * (-0.5 * square).exp()
    left = torch.ones(len(pixels), dtype=torch.float64)
    running = torch.ones(len(pixels), dtype=torch.bool)
    image = torch.zeros(len(pixels), 3, dtype=torch.float64)
    for row in torch.argsort(z.detach(), stable=True).tolist():
        if z[row] <= near:
            continue
        alpha = raw[row].clamp(max=ALPHA_MAX)
        touched = running & (alpha >= 1 / 255)
        after = left * (1 - alpha)
        stops = touched & (after < STOP)
        running = running & ~stops
        drawn = touched & ~stops
        image = image + torch.where(drawn, left * alpha, 0.0)[:, None] * colours[row]
        left = torch.where(drawn, after, left)
    image = image + left[:, None] * torch.tensor(background, dtype=torch.float64)
    return image.reshape(camera.height, camera.width, 3)
