"""The worked example of SPEC's appendix against the codec, step by step."""

import re

import numpy as np

from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.lab.conformance import worked_example

NUMBER = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"
LINES = worked_example.lines()


def numbers(text):
    return [float(number) for number in re.findall(NUMBER, text)]


def part(title):
    """The lines from one that begins with a title to the next empty one."""
    start = next(i for i, line in enumerate(LINES) if line.startswith(title))
    end = next((i for i in range(start, len(LINES)) if not LINES[i]), len(LINES))
    return LINES[start:end]


def behind(lines, pattern):
    """The numbers behind the last colon of each line that a pattern matches."""
    return [numbers(line.rsplit(":", 1)[1]) for line in lines if re.search(pattern, line)]


def decoded(**how):
    with open_cogs(BytesSource(worked_example.valid().data)) as file:
        file.verify()
        return file.decode(**how)


def assert_bits(shown, values):
    np.testing.assert_array_equal(np.array(shown, np.float32).reshape(values.shape), values)


def test_values_that_are_shown_are_what_the_reader_decodes(kernels):
    coarse, fine = decoded(refine=False), decoded()
    assert_bits(behind(part("scales"), r"row \d: codes"), coarse.scales)
    assert_bits(behind(part("scales"), r"row \d: digit"), fine.scales)
    assert_bits(behind(part("means"), r"^    codes"), coarse.means)
    assert_bits(behind(part("means"), r"^    refined"), fine.means)
    assert_bits(behind(part("quats"), r"divided by the norm"), fine.quats)
    colours = part("opacities")
    assert_bits(behind(colours, r"^  codes"), fine.opacities)
    assert_bits(behind(colours, r"row \d: codes"), fine.sh0)
    assert_bits([numbers(line) for line in part("shN") if re.match(r"    \S", line)], fine.shN)


def test_extra_bits_that_are_shown_are_the_step_model_s():
    lines = part("extra bits")
    scales = decoded(refine=False).scales
    for name in ("means", "swing", "twist"):
        (model,) = [numbers(line.split("=")[1]) for line in lines if f"{name}: c0" in line]
        shown = [int(re.search(rf"{name} \S+, h = (\d+)", line)[1]) for line in lines[4:]]
        assert StepModel(tuple(model)).extra_bits(scales).tolist() == shown


def test_means_follow_from_the_codes_that_are_shown():
    for line in part("means"):
        found = re.search(r"codes ([^:]*), step 2\^-(\d+): (.*)", line)
        if found:
            codes, bits, values = numbers(found[1]), int(found[2]), numbers(found[3])
            # Cells of step 1 from the minima -1, -2 and 0.
            exact = np.array(codes) * 2.0**-bits + np.array([-1.0, -2.0, 0.0])
            np.testing.assert_array_equal(np.float32(exact), np.float32(values))


def test_quaternions_follow_from_what_is_shown():
    lines = part("quats")
    for codes, divided in zip(lines[3::2], lines[4::2], strict=True):
        a, b, c = numbers(codes.rsplit("=", 1)[1])
        raw, unit = divided.split(", divided by the norm: ")
        assert numbers(raw) == [1.0, a + b * c, b - a * c, c]
        length = np.linalg.norm(numbers(raw))
        np.testing.assert_allclose(np.array(numbers(raw)) / length, numbers(unit), atol=1e-7)
