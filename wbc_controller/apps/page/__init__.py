"""The browser page: a robot with the state of its controller, and handles and controls that command it by topics."""
