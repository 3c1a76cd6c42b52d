"""The workers' side of the app: their WebSocket, their clocks, and the commands sent to each."""
