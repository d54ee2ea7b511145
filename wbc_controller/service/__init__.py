"""The controller and the guard as services on any transport: inputs, the loop, outputs."""
