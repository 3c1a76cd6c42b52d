"""Lower the bounds after names became better."""

from __future__ import annotations

from tests import vocabulary
from tests.vocabulary import source

TREES = vocabulary.modules()
vocabulary.lower(vocabulary.DUPLICATE_TYPES, vocabulary.duplicate_types(TREES))
AVOIDED = vocabulary.avoided_words()
vocabulary.lower(vocabulary.AVOIDED_IDENTIFIERS, vocabulary.avoided_identifiers(TREES, AVOIDED))
vocabulary.lower(source.AVOIDED_IN_SOURCE, source.by_folder(source.found(source.AvoidedWords(AVOIDED))))
