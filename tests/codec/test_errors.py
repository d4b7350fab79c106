"""Errors keep code and message when pickled or printed."""

import pickle

import pytest

from cogsplat.codec.errors import (
    Cancelled,
    CogsplatError,
    DataError,
    FormatError,
    LimitError,
    StorageError,
    TruncatedError,
)
from cogsplat.formats.storage.atomic import TargetExistsError

ERRORS = [
    DataError("invalid-rows", "3 of 4 rows"),
    LimitError("decoded-size", "too much"),
    StorageError("io", "disk"),
    FormatError("root-crc", "does not match", clause="3.3", offset=64),
    TruncatedError("file-truncated", "short", clause="3.3", needed=900),
    Cancelled(),
    TargetExistsError("scene.ply"),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_errors_pass_between_processes(error: CogsplatError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)
    assert again.exit_code == error.exit_code
