"""Mock robot on MuJoCo, imported only here."""
