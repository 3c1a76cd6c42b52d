"""TLS of connections, with a certificate that is replaced while the server runs."""
