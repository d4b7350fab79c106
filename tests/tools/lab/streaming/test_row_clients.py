"""Clients that fetch single splats: cost and order of the pieces."""

import numpy as np
import pytest

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import NEAR, in_picture
from cogsplat.codec.order import baselines
from cogsplat.tools.lab.streaming.row_clients import RowClient, antimatter_client, sgss_client
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, synth_rooms

SPLATS = synth_rooms(4, 5000, sh_degree=0)
VIEWS = rooms_cameras(4, views=2)


@pytest.fixture(params=["antimatter", "sgss"])
def client(request: pytest.FixtureRequest) -> RowClient:
    if request.param == "antimatter":
        return antimatter_client(SPLATS, 123_457, 99)
    return sgss_client(SPLATS, VIEWS, 123_457, 99)


def test_every_splat_is_fetched_once_at_the_mean_cost(client: RowClient) -> None:
    rows = np.concatenate(client.rows)
    assert sorted(rows.tolist()) == list(range(len(SPLATS)))
    units = client.units
    assert units.size_bytes.sum() == 123_457
    assert units.end[-1] == 99 + 123_457
    counts = np.array([len(piece) for piece in client.rows])
    np.testing.assert_allclose(units.size_bytes, counts * 123_457 / len(SPLATS), atol=1.0)


def test_antimatter_orders_by_volume_times_opacity() -> None:
    client = antimatter_client(SPLATS, 1000, 0)
    order = np.concatenate([client.rows[unit] for unit in np.argsort(-client.priorities(VIEWS[0]))])
    values = baselines.antimatter(SPLATS)[order]
    assert (np.diff(values) <= 0.0).all()


def _seen_share(client: RowClient, camera: Camera, share: float) -> float:
    """Return the share of the splats in a picture among the first share of the fetch order."""
    order = np.argsort(-client.priorities(camera), kind="stable")
    rows = np.concatenate([client.rows[unit] for unit in order])
    inside = in_picture(SPLATS.means.astype(np.float64), camera, NEAR)[rows]
    return float(inside[: int(share * len(rows))].sum() / inside.sum())


def test_cells_in_the_frustum_come_first() -> None:
    sgss, antimatter = sgss_client(SPLATS, VIEWS, 1000, 0), antimatter_client(SPLATS, 1000, 0)
    for camera in VIEWS:
        assert _seen_share(sgss, camera, 0.6) > _seen_share(antimatter, camera, 0.6)
    assert _seen_share(sgss, VIEWS[0], 1.0) == 1.0


def test_pieces_of_a_cell_are_ordered_by_score() -> None:
    client = sgss_client(SPLATS, VIEWS, 1000, 0)
    score = baselines.sgss(SPLATS)
    # Only the last piece of a cell has fewer splats than the others.
    largest = max(len(piece) for piece in client.rows)
    followed = [n for n, piece in enumerate(client.rows[:-1]) if len(piece) == largest]
    assert followed
    priorities = client.priorities(VIEWS[0])
    for piece in followed:
        assert score[client.rows[piece]].min() >= score[client.rows[piece + 1]].max()
        assert priorities[piece] > priorities[piece + 1]
