"""The meaning of the values on the link: parameters, values, status bits. No bytes travel here."""
