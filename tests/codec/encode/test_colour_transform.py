from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.encode import colour_transform
from cogsplat.codec.errors import FormatError
from cogsplat.codec.rate import allocation
from cogsplat.codec.segments.codebooks import ColourCodebook, decode_colour_codebook
from cogsplat.codec.segments.tails import decode_tail
from cogsplat.codec.splats import sh_coefficients
from cogsplat.codec.streams import records

f32 = np.float32
CHUNKS = [slice(0, 100), slice(100, 260), slice(260, 300)]
NOWHERE = np.zeros((15, 15))


def coefficients_of(degree, rows=300, seed=1, scale=0.2):
    """Correlated: few latent directions and a little of everything."""
    rng = np.random.default_rng(seed)
    size = 3 * (sh_coefficients(degree) - 1)
    latent = rng.normal(size=(rows, 4)) @ rng.normal(size=(4, size))
    values = scale * (latent + 0.2 * rng.normal(size=(rows, size)))
    return values.reshape(rows, -1, 3).astype(f32)


def spread_of(seed=2):
    """Covariance of bases as scores have it: positive, some directions hardly seen."""
    turned, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(15, 15)))
    return (turned * np.geomspace(0.3, 1e-9, 15)) @ turned.T


def energy_of(rows=300, seed=3):
    return np.random.default_rng(seed).lognormal(-9, 1, rows)


def fitted(degree=3, lagrangian=1e-9, spread=None, **options):
    values = coefficients_of(degree)
    given = spread_of() if spread is None else spread
    return values, colour_transform.fit(
        values.__getitem__, energy_of(), given, lagrangian, CHUNKS, **options
    )


def stored(basis, degree):
    """The basis as a decoder has it."""
    payloads = {
        band: memoryview(records.pack([one])) for band, one in enumerate(basis.streams(), start=1)
    }
    assert len(payloads) == degree
    return decode_colour_codebook(payloads, len(basis.rows), degree, "basis")


def with_rows(basis, rows):
    return replace(basis, rows=rows.reshape(len(rows), -1))


def decoded(stream, codebook):
    out = np.full((stream.rows, *codebook.shN.shape[1:]), np.nan, f32)
    decode_tail(memoryview(records.pack([stream])), {0: codebook}, out, "tail")
    return out


def cost(missed, metric):
    flat = missed.reshape(len(missed), -1)
    return float(np.einsum("ni,ij,nj->", flat, metric, flat) / len(flat))


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_rows_are_orthonormal_for_the_views_and_the_strongest_come_first(degree):
    values, basis = fitted(degree)
    rows = basis.rows.astype(float)
    size = 3 * (sh_coefficients(degree) - 1)
    assert basis.rows.shape == (size, size)
    np.testing.assert_allclose(rows @ basis.metric @ rows.T, np.eye(size), atol=1e-5)
    strength = np.zeros(size)
    for run in CHUNKS:
        step = allocation.shn_step(1e-9, energy_of()[run])
        strength += np.square(basis.coordinates(values[run]) / step).sum(axis=0)
    assert (np.diff(strength) <= 1e-6 * strength[0]).all()
    # Four latent directions hold nearly everything.
    assert strength[:12].sum() > 0.9 * strength.sum()


def test_the_metric_is_what_views_see_and_a_little_of_everywhere():
    spread = spread_of()
    _, basis = fitted(3, spread=spread)
    even = np.eye(15) / (4 * np.pi)
    np.testing.assert_allclose(basis.metric, np.kron(0.9 * spread + 0.1 * even, np.eye(3)))
    _, unseen = fitted(3, spread=NOWHERE)
    np.testing.assert_allclose(unseen.metric, np.kron(even, np.eye(3)))


@pytest.mark.parametrize("principal", [True, False])
def test_a_full_basis_gives_every_coefficient_back(principal):
    values, basis = fitted(2, lagrangian=1e-14, principal=principal)
    assert len(basis.rows) == 24
    back = basis.coordinates(values) @ basis.rows.astype(float)
    np.testing.assert_allclose(back.reshape(values.shape), values, atol=1e-5)


def test_coordinates_leave_what_no_row_could_mend():
    values, basis = fitted(3)
    few = replace(basis, rows=basis.rows[[7, 3, 0]] * f32(1.7) + basis.rows[[1, 2, 30]])
    left = values.reshape(300, -1) - few.coordinates(values) @ few.rows.astype(float)
    assert np.abs(left @ basis.metric @ few.rows.T.astype(float)).max() < 1e-6


def test_without_principal_axes_each_row_is_a_coefficient():
    _, basis = fitted(3, lagrangian=1e-13, principal=False)
    assert ((basis.rows != 0).sum(axis=1) == 1).all()
    assert ((basis.rows != 0).sum(axis=0) == 1).all()
    rows = basis.rows.astype(float)
    np.testing.assert_allclose(np.diagonal(rows @ basis.metric @ rows.T), 1, rtol=1e-5)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_basis_is_stored_to_one_part_in_256(degree):
    _, basis = fitted(degree)
    codebook = stored(basis, degree)
    assert codebook.shN.shape == (len(basis.rows), sh_coefficients(degree) - 1, 3)
    span = np.ptp(basis.rows, axis=0)
    flat = codebook.shN.reshape(len(basis.rows), -1)
    assert (np.abs(flat - basis.rows) <= 0.51 * span / 255 + 1e-6).all()
    again = with_rows(basis, codebook.shN)
    assert again.rows.tobytes() == codebook.shN.tobytes()
    assert again.metric is basis.metric


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("lagrangian", [1e-5, 1e-8, 1e-12])
def test_what_is_missed_is_source_less_decoded(degree, lagrangian):
    values, basis = fitted(degree, lagrangian)
    codebook = stored(basis, degree)
    basis = with_rows(basis, codebook.shN)
    for run in CHUNKS:
        stream, missed = basis.encode(values[run], energy_of()[run], lagrangian, 0)
        out = decoded(stream, codebook)
        np.testing.assert_allclose(values[run] - missed, out, atol=3e-6)


def test_a_lower_slope_misses_less_and_costs_more():
    misses, sizes = [], []
    for lagrangian in (1e-4, 1e-6, 1e-8, 1e-10):
        values, basis = fitted(3, lagrangian)
        basis = with_rows(basis, stored(basis, 3).shN)
        stream, missed = basis.encode(values[CHUNKS[1]], energy_of()[CHUNKS[1]], lagrangian, 0)
        misses.append(cost(missed, basis.metric))
        sizes.append(len(records.pack([stream])))
    assert misses == sorted(misses, reverse=True)
    assert sizes == sorted(sizes)
    assert misses[-1] < 1e-3 * misses[0]
    assert sizes[-1] > 4 * sizes[0]


def test_principal_axes_take_fewer_bytes_for_what_they_miss():
    results = []
    for principal in (True, False):
        values, basis = fitted(3, 1e-8, principal=principal)
        basis = with_rows(basis, stored(basis, 3).shN)
        run = CHUNKS[1]
        stream, missed = basis.encode(values[run], energy_of()[run], 1e-8, 0)
        results.append((8 * len(records.pack([stream])), basis.error(missed, energy_of()[run])))
    (bits, error), (single_bits, single_error) = results
    assert bits < 0.8 * single_bits
    # More is missed than by single coefficients, but less than the bits between them are worth.
    price = allocation.bit_price(1e-8)
    assert error + price * bits < 0.6 * (single_error + price * single_bits)


def test_views_get_the_directions_that_they_see():
    # One direction is all that is ever seen: errors go where they are not.
    seen = np.zeros((15, 15))
    seen[4, 4] = 0.5
    errors = []
    for spread in (seen, NOWHERE):
        values, basis = fitted(3, 1e-7, spread=spread)
        _, missed = basis.encode(values, energy_of(), 1e-7, 0)
        errors.append(np.square(missed[:, 4]).mean() / np.square(missed).mean())
    assert errors[0] < 0.2 * errors[1]


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_coefficients_of_zero_are_one_row_that_nobody_uses(degree):
    values = np.zeros((300, sh_coefficients(degree) - 1, 3), f32)
    basis = colour_transform.fit(values.__getitem__, energy_of(), spread_of(), 1e-9, CHUNKS)
    assert len(basis.rows) == 1
    codebook = stored(basis, degree)
    stream, missed = with_rows(basis, codebook.shN).encode(values, energy_of(), 1e-9, 0)
    assert not missed.any()
    assert not decoded(stream, codebook).any()
    assert [plane.any() for plane in stream.planes] == [False]


def test_rows_that_no_chunk_would_use_are_left_out():
    values, fine = fitted(3, 1e-12)
    _, coarse = fitted(3, 1e-6)
    assert len(fine.rows) == 45
    assert 1 <= len(coarse.rows) < 45
    _, none = fitted(3, 1e6)
    assert len(none.rows) == 1
    stream, missed = none.encode(values, energy_of(), 1e6, 0)
    assert not stream.planes[0].any()
    np.testing.assert_array_equal(missed, values)


def test_a_row_that_few_splats_use_is_stored_where_it_shows():
    # One direction is that of a single splat.
    values = np.zeros((300, 15, 3), f32)
    values[:, 0, 0] = np.linspace(-1, 1, 300)
    energy = np.full(300, 1e-4)

    def rows(size):
        values[7, 9, 1] = size
        return colour_transform.fit(values.__getitem__, energy, NOWHERE, 1e-7, CHUNKS).rows

    # Two steps of error are worth fewer bits than the row has, twenty are worth more.
    step = allocation.shn_step(1e-7, energy) * np.sqrt(4 * np.pi)
    assert len(rows(2 * step)) == 1
    assert len(rows(20 * step)) == 2


@pytest.mark.parametrize("rows", [1, 2])
@pytest.mark.parametrize("spread", [NOWHERE, spread_of()])
def test_a_splat_or_two_have_a_basis(rows, spread):
    values, energy = coefficients_of(3, rows), energy_of(rows)
    basis = colour_transform.fit(values.__getitem__, energy, spread, 1e-12, [slice(0, rows)])
    codebook = stored(basis, 3)
    stream, missed = with_rows(basis, codebook.shN).encode(values, energy, 1e-12, 0)
    np.testing.assert_allclose(decoded(stream, codebook), values, atol=0.01)
    np.testing.assert_allclose(decoded(stream, codebook), values - missed, atol=3e-6)


@pytest.mark.parametrize("energy", [1e-300, 1e-30, 1.0, 1e30, 1e200])
@pytest.mark.parametrize("scale", [0.0, 1e-20, 1.0, 1e4])
def test_steps_of_any_energy_fit_the_format(energy, scale):
    values = (coefficients_of(2) * f32(scale)).astype(f32)
    energies = np.full(300, energy)
    basis = colour_transform.fit(values.__getitem__, energies, NOWHERE, 1e-9, CHUNKS)
    codebook = stored(basis, 2)
    stream, missed = with_rows(basis, codebook.shN).encode(values, energies, 1e-9, 0)
    out = decoded(stream, codebook)
    limit = 1e-5 * max(scale, 1e-15)
    np.testing.assert_allclose(out, values - missed, atol=limit)
    if energy >= 1:
        np.testing.assert_allclose(out, values, atol=max(1e-3, 1e-4 * scale))


def test_fitting_and_encoding_are_repeatable():
    values, basis = fitted(3)
    _, again = fitted(3)
    assert basis.rows.tobytes() == again.rows.tobytes()
    payloads = {
        records.pack([one.encode(values, energy_of(), 1e-9, 0)[0]]) for one in (basis, again)
    }
    assert len(payloads) == 1


def test_a_codebook_number_is_written():
    values, basis = fitted(1)
    codebook = stored(basis, 1)
    stream, missed = with_rows(basis, codebook.shN).encode(values, energy_of(), 1e-9, 6)
    tail = memoryview(records.pack([stream]))
    out = np.full((300, 3, 3), np.nan, f32)
    others = ColourCodebook(np.zeros((9, 3, 3), f32))
    decode_tail(tail, {0: others, 6: codebook}, out, "tail")
    np.testing.assert_allclose(out, values - missed, atol=3e-6)
    assert np.abs(out).max() > 0.1
    with pytest.raises(FormatError, match="codebook 6"):
        decode_tail(tail, {0: codebook}, out, "tail")
