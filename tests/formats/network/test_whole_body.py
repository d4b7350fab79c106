from cogsplat.formats.network.whole_body import WholeBody

DATA = bytes(range(256)) * 100_000


def test_what_comes_a_second_time_is_not_kept_twice():
    body = WholeBody()
    body.receive(0, DATA[:1000])
    body.receive(0, DATA[:700])
    body.receive(700, DATA[700:2000])
    assert body.received == 2000
    assert body.bytes_at(600, 1900) == DATA[600:1900]
    body.close()


def test_a_long_body_goes_to_a_file():
    body = WholeBody()
    for at in range(0, len(DATA), 1 << 20):
        body.receive(at, DATA[at : at + (1 << 20)])
    assert body.received == len(DATA)
    assert body.bytes_at(20_000_000, 20_000_300) == DATA[20_000_000:20_000_300]
    body.close()
