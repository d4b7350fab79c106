"""Programs: the command line, evaluation, benchmarks, the test scene, the conformance vectors."""
