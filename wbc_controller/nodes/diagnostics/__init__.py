"""What the controller reports about itself: diagnostics, markers, the live audit, and recordings of cycles."""
