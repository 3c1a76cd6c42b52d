"""What the words of the link mean: parameters, values, status bits. No bytes travel here."""
