"""What Python allocates in a test, without what loads kernels in the background meanwhile."""

import tracemalloc

from cogsplat.codec.streams.decoding_tiers import LOADER


def start_tracing() -> None:
    """Begin to trace what is allocated, when kernels that are being loaded are there."""
    LOADER.join()
    tracemalloc.start()
