"""Cross-checks of readers and writers against third-party programs."""
