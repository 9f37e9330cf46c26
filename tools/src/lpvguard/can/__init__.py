"""CAN: the one table of messages (``catalogue.toml``) and what is made from it: our DBC and the C codec."""
