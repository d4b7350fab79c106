import pytest

from cogsplat.codec.errors import StorageError
from cogsplat.formats.network.backoff import TransientError
from cogsplat.formats.network.range_responses import ResponseHead, check_response_head

RIGHT = {"content-range": "bytes 10-19/100", "content-length": "10", "etag": '"a"'}


def stated(status, headers, first=10, end=20):
    return check_response_head(status, headers, first, end, "https://a.b/c.cogs")


def test_a_range_as_it_was_asked_for():
    assert stated(206, RIGHT) == ResponseHead(10, 20, 100, '"a"', is_whole=False)


def test_a_range_may_be_shorter_and_the_total_unknown():
    short = {"content-range": "bytes 10-14/*"}
    assert stated(206, short) == ResponseHead(10, 15, None, None, is_whole=False)


@pytest.mark.parametrize(
    "wrong",
    [
        "",
        "bytes 10-19",
        "bytes 11-19/100",
        "bytes 9-19/100",
        "bytes 10-20/100",
        "bytes 10-9/100",
        "bytes 10-19/15",
        "bytes -10/100",
        "items 10-19/100",
        "bytes 10-19/" + "9" * 30,
        "bytes ١٠-19/100",
    ],
)
def test_another_range_is_refused(wrong):
    with pytest.raises(StorageError, match="bytes 10") as caught:
        stated(206, {"content-range": wrong})
    assert caught.value.code == "answer-range"


def test_lengths_that_disagree_are_refused():
    with pytest.raises(StorageError, match="Content-Length 9 "):
        stated(206, RIGHT | {"content-length": "9"})


@pytest.mark.parametrize("etag", ['W/"a"', "", "a"])
def test_only_strong_etags_count(etag):
    assert stated(206, RIGHT | {"etag": etag}).etag is None


def test_a_whole_file_with_and_without_its_length():
    assert stated(200, {"content-length": "100"}) == ResponseHead(0, 100, 100, None, is_whole=True)
    assert stated(200, {}) == ResponseHead(0, -1, None, None, is_whole=True)


@pytest.mark.parametrize("encoding", ["gzip", "br", "zstd", "GZIP"])
@pytest.mark.parametrize("status", [200, 206])
def test_encoded_answers_are_refused(status, encoding):
    with pytest.raises(StorageError, match=encoding.lower()) as caught:
        stated(status, RIGHT | {"content-encoding": encoding})
    assert caught.value.code == "answer-encoding"
    assert stated(status, RIGHT | {"content-encoding": "identity"})


def test_several_parts_are_refused():
    with pytest.raises(StorageError, match="multipart"):
        stated(206, RIGHT | {"content-type": "Multipart/Byteranges; boundary=a"})


@pytest.mark.parametrize(
    ("status", "code"),
    [
        (204, "http-status"),
        (400, "http-status"),
        (401, "permission"),
        (403, "permission"),
        (404, "not-found"),
        (410, "not-found"),
        (412, "source-changed"),
        (416, "source-changed"),
        (501, "http-status"),
    ],
)
def test_refusals_are_told_apart(status, code):
    with pytest.raises(StorageError, match=str(status)) as caught:
        stated(status, {})
    assert caught.value.code == code


@pytest.mark.parametrize("status", [408, 425, 429, 500, 502, 503, 504])
def test_what_may_pass(status):
    with pytest.raises(TransientError, match=f"status {status}, retry after 7 s") as caught:
        stated(status, {"retry-after": "7"})
    assert caught.value.wait_seconds == 7


def test_an_empty_file_has_no_range():
    empty = {"content-range": "bytes */0"}
    assert stated(416, empty, first=0) == ResponseHead(0, 0, 0, None, is_whole=False)
    with pytest.raises(StorageError, match="no such range"):
        stated(416, {"content-range": "bytes */5"}, first=0)
