"""Fuzz a target for as long as you like: ``python tests/fuzz/run.py spz --seconds 3600``.

Takes atheris (``pip install atheris``; Linux, CPython 3.11 to 3.13), which follows what of our code
each input reaches. What it finds is written to ``--findings`` with the command that repeats it;
without atheris, ``--mutations N`` runs N mutations of the corpus by our own mutator.
"""

import argparse
import os
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests"
sys.path[:0] = [str(ROOT), *(str(TESTS / name) for name in ("codec", "formats", "fuzz"))]

_MAX_INPUT_BYTES = 1 << 16
_MEMORY_MIB = 1024
_KERNEL = re.compile(r"^@(?:inner_)?(?:kernel|exact)\b", re.MULTILINE)
# Its functions are compiled into kernels of other modules.
_COMPILED_ELSEWHERE = "cogsplat.codec.geometry.sh"


def kernel_modules() -> list[str]:
    """Return the modules with compiled kernels; numba cannot compile instrumented code."""
    found = [
        ".".join(("cogsplat", *path.relative_to(ROOT).with_suffix("").parts))
        for path in sorted((ROOT / "codec").rglob("*.py"))
        if _KERNEL.search(path.read_text())
    ]
    return [*found, _COMPILED_ELSEWHERE]


def main() -> None:
    """Parse the command line and fuzz."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("target", help="a folder of tests/fuzz/corpus, or all with --mutations")
    parser.add_argument("--seconds", type=int, default=60, help="how long (default 60)")
    parser.add_argument("--mutations", type=int, help="so many mutations of every file instead")
    parser.add_argument(
        "--input-seconds", type=int, default=10, help="longest input; more on a busy machine"
    )
    parser.add_argument("--findings", type=Path, default=Path("fuzz-findings"))
    options = parser.parse_args()
    if options.mutations is not None:
        _mutate(options.target, options.mutations, options.findings)
        return
    import atheris

    # Before our modules are first imported, so that atheris sees what they reach.
    with atheris.instrument_imports(include=["cogsplat"], exclude=kernel_modules()):
        from targets import TARGETS, run_once
    import mutations
    from http_scripts import made_script
    from seeds import corpus

    target = TARGETS[options.target]
    options.findings.mkdir(parents=True, exist_ok=True)
    grown = options.findings / f"{target.name}-corpus"
    grown.mkdir(exist_ok=True)
    for name, data in corpus(target.name).items():
        (grown / name).write_bytes(data)
        # What a target prepares once is not part of the time of an input.
        run_once(target, data)

    def mutate(data: bytes, max_size: int, seed: int) -> bytes:
        # Most mutations of a script are no script any more: half are made anew.
        if target.name == "http" and seed & 2:
            return made_script(seed)[:max_size]
        # Half by structure, half as libFuzzer does it.
        if seed & 1:
            return mutations.mutated(data, seed, max_size)
        return bytes(atheris.Mutate(data, max_size))

    arguments = [
        sys.argv[0],
        f"-max_total_time={options.seconds}",
        f"-max_len={_MAX_INPUT_BYTES}",
        f"-rss_limit_mb={_MEMORY_MIB}",
        f"-timeout={options.input_seconds}",
        f"-artifact_prefix={options.findings}{os.sep}{target.name}-",
        str(grown),
    ]
    atheris.Setup(arguments, lambda data: run_once(target, data) and None, custom_mutator=mutate)
    atheris.Fuzz()


def _mutate(name: str, count: int, findings: Path) -> None:
    from http_scripts import made_script
    from mutations import mutated
    from seeds import corpus
    from targets import TARGETS, run_once

    for target in TARGETS.values() if name == "all" else [TARGETS[name]]:
        refused = runs = 0
        inputs = [
            (f"{seed_name}-{seed}", mutated, (data, seed))
            for seed_name, data in corpus(target.name).items()
            for seed in range(count)
        ]
        if target.name == "http":
            # Most mutations of a script are no script any more: as many are made anew.
            inputs += [(f"made-{seed}", made_script, (seed,)) for seed in range(len(inputs))]
        for label, make, arguments in inputs:
            changed = make(*arguments)
            runs += 1
            try:
                refused += run_once(target, changed) is not None
            except Exception:
                findings.mkdir(parents=True, exist_ok=True)
                path = findings / f"{target.name}-{label}"
                path.write_bytes(changed)
                print(f"{path}: not a refusal")
                raise
        print(f"{target.name}: {runs} mutations, {refused} refused")


if __name__ == "__main__":
    main()
