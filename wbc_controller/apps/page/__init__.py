"""Page in the browser."""
