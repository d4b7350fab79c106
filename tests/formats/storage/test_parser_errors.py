import pytest

from cogsplat.codec.errors import CogsplatError, DataError, FormatError
from cogsplat.formats.storage.parser_errors import parser_errors


def refusal(found: str) -> FormatError:
    return FormatError("image-damaged", f"a.png: {found}, expected a complete image")


@pytest.mark.parametrize(
    ("error", "found"),
    [(KeyError("IDAT"), "'IDAT'"), (OSError("truncated"), "truncated"), (EOFError(), "EOFError")],
)
def test_exceptions_of_a_parser_become_the_refusal(error: Exception, found: str) -> None:
    with (
        pytest.raises(FormatError, match=f"^a.png: {found}, expected") as caught,
        parser_errors(refusal),
    ):
        raise error
    assert caught.value.code == "image-damaged"
    assert caught.value.__cause__ is error


def test_a_long_text_is_cut() -> None:
    with pytest.raises(CogsplatError, match=r"^a\.png: x{200}, expected"), parser_errors(refusal):
        raise ValueError("x" * 10_000)


@pytest.mark.parametrize(
    ("error", "passed"),
    [
        (MemoryError("no room"), ()),
        (DataError("photo", "a.png: 5x3 px, expected 3x5"), ()),
        (OSError("the disk is gone"), (OSError,)),
        (KeyboardInterrupt(), ()),
    ],
)
def test_errors_that_say_nothing_about_the_file_pass(
    error: BaseException, passed: tuple[type[Exception], ...]
) -> None:
    with pytest.raises(type(error)) as caught, parser_errors(refusal, passed=passed):
        raise error
    assert caught.value is error
