"""Flight recorder: inputs and results of each cycle, for replay."""
