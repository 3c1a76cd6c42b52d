"""What it was then: every reading kept, downsampled by age, and drawn over any span."""
