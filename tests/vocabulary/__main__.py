"""Lower the bounds after names became better."""

from __future__ import annotations

from tests import vocabulary

TREES = vocabulary.modules()
vocabulary.lower(vocabulary.DUPLICATE_TYPES, vocabulary.duplicate_types(TREES))
vocabulary.lower(
    vocabulary.AVOIDED_IDENTIFIERS, vocabulary.avoided_identifiers(TREES, vocabulary.avoided_words())
)
