"""Safety between controller and joints: checks, the supervisor of all commands, and the guard."""
