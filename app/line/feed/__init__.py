"""The workers' side of the app: their WebSocket, their clocks, and the way down to each."""
