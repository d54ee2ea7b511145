"""The flight recorder: inputs and results of each cycle in a file that can be read and solved again."""
