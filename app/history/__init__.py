"""What it was then: every reading kept, thinned by age, and drawn over any span."""
