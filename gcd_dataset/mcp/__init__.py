"""``gcd-mcp``: a server of the Model Context Protocol, whose tools draw, check, drape, score and export garments."""
