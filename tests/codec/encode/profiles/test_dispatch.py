import pytest

from cogsplat.codec.encode.config import PROFILE_NAMES
from cogsplat.codec.encode.profiles.dispatch import PROFILES, PlannedScene


def test_the_table_has_the_profiles_that_a_configuration_names():
    assert tuple(PROFILES) == PROFILE_NAMES
    with pytest.raises(TypeError):
        PROFILES["other"] = PROFILES["vq"]


def test_a_scene_without_rows_has_no_chunk_to_encode():
    planned = PlannedScene()
    assert len(planned.codebooks) == 0
    with pytest.raises(ValueError, match="rows 0:5"):
        planned.encode_chunk(slice(0, 5))
