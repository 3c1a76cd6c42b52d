"""The plant's broker: each line as a Sparkplug B edge node, and the overview of many lines."""
