"""How results look: tables in a terminal and in a notebook, and plots."""
