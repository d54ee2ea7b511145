"""Controller of one robot: references, quadratic program, supervisor, live settings."""
