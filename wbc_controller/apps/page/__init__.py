"""Page in the browser that shows and commands a robot."""
