"""Any server shows every bus: a request of another server's bus is passed on to the home of that bus."""
