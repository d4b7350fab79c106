"""The stream kinds of SPEC 6, a writer and a reader each, and what they are made of."""
