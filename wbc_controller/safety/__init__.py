"""What stands between the controller and the joints: checks, and the supervisor that makes every command."""
