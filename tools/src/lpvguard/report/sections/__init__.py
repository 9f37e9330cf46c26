"""Sections of the page, a module each. In: an identification, its drives, or what another command wrote. Out:
HTML that begins with an h2."""
