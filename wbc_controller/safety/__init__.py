"""Safety between the controller and the joints: checks, the supervisor that makes every command, and the guard."""
