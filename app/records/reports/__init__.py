"""Reports of a shift, a day or any span: on a page, as files, and by mail on a schedule."""
