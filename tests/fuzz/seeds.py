"""The files that fuzzing starts from."""

from pathlib import Path

CORPUS = Path(__file__).parent / "corpus"
VECTORS = Path(__file__).resolve().parents[1] / "vectors"

_MOST_VECTORS = 40


def corpus(target: str) -> dict[str, bytes]:
    """Return the files of a target by name; COGS files are the smallest valid vectors as well."""
    paths = sorted(path for path in (CORPUS / target).glob("*") if path.is_file())
    if target == "cogs":
        valid = (VECTORS / "valid").glob("*.cogs")
        by_size = sorted(valid, key=lambda path: (path.stat().st_size, path.name))
        paths += by_size[:_MOST_VECTORS]
        # One for each reason of refusal.
        paths += sorted((VECTORS / "invalid").glob("*.cogs"))
    return {path.name: path.read_bytes() for path in paths}
