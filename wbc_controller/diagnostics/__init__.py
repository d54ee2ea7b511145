"""What the controller says about itself: diagnostics by topic, and recordings of cycles."""
