"""Programs for users: terminal commands, the browser page, configurations from a URDF, the demo."""
