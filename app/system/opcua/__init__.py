"""The OPC UA server: the lines of this site, read only, in a process of its own."""
