from cogsplat.formats.network.traffic import Traffic


def test_bandwidth_counts_the_time_in_which_something_was_under_way():
    assert Traffic(2, 3000, 0, 1.5).bytes_per_second == 2000
    assert Traffic().bytes_per_second == 0
