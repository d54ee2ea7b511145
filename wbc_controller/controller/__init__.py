"""The controller as one object: references, quadratic program, supervisor, and settings that change while it runs."""
