"""Steps that commands share: reading, editing, ordering, measuring and writing scenes."""
