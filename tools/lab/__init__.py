"""For people who measure and implement: benchmarks, conformance, simulation, test scenes."""
