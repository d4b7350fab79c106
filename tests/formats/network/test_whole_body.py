from cogsplat.formats.network.whole_body import WholeBody

DATA = bytes(range(256)) * 100_000


def test_what_comes_a_second_time_is_not_kept_twice():
    body = WholeBody()
    assert body.receive(0, DATA[:1000], None) == 1000
    assert body.receive(0, DATA[:700], None) == 0
    assert body.receive(700, DATA[700:2000], None) == 1000
    assert body.received == 2000
    # What lies beyond the end of the file is dropped.
    assert body.receive(1900, DATA[1900:3000], 2500) == 500
    assert body.receive(2600, DATA[2600:3000], 2500) == 0
    assert body.received == 2500
    assert body.bytes_at(600, 1900) == DATA[600:1900]
    body.close()


def test_a_long_body_goes_to_a_file():
    body = WholeBody()
    for at in range(0, len(DATA), 1 << 20):
        body.receive(at, DATA[at : at + (1 << 20)], None)
    assert body.received == len(DATA)
    assert body.bytes_at(20_000_000, 20_000_300) == DATA[20_000_000:20_000_300]
    body.close()
