"""Tables, plots, pages, shapes and geometry."""
