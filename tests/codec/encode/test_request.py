from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.order.orders import OrderConfig

UP = np.array([0.0, 0.0, 1.0])
VIEW = oracle.camera()


def test_a_request_takes_the_stored_look():
    completed = EncodeRequest(preset="fast").with_stored_look(UP, VIEW)
    assert completed.up is UP
    assert completed.view is VIEW
    assert completed.preset == "fast"


@pytest.mark.parametrize(
    "own",
    [
        {"cameras": [VIEW]},
        {"up": -UP},
        {"view": VIEW},
        {"config": EncodeConfig(ordering=OrderConfig(first_view=VIEW))},
    ],
)
def test_a_request_with_a_look_of_its_own_keeps_it(own):
    request = replace(EncodeRequest(), **own)
    assert request.with_stored_look(UP, oracle.camera(0.5)) is request
