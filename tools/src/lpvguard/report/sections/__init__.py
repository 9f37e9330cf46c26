"""Sections of the page, one module per section.

In: an identification, its drives, or the result of another command. Out: HTML that begins with an h2.
"""
