"""Sections of the page, a module each.

In: an identification, its drives, or the result of another command. Out: HTML that begins with an h2.
"""
