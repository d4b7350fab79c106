"""Which cameras a scene is looked at from: given, held out, roaming, planned."""
