"""Tables, plots and pages of results; shapes and geometry of robots."""
