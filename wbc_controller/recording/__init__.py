"""Flight recorder, for replay."""
