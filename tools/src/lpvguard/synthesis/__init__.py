"""H∞ and μ: certified synthesis and analysis of linear controllers (DESIGN 4.6)."""
