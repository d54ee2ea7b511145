"""Safety: checks, supervisor of all commands, guard."""
