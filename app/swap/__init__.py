"""A dead unit replaced by a spare, step by step, until it is proven to be what the dead one was."""
