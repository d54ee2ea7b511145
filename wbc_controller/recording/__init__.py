"""The flight recorder: what each cycle was given and what came of it, on a file that can be read and solved again."""
