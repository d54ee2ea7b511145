"""The controller and the guard as services on any transport: inputs, the control loop, outputs."""
