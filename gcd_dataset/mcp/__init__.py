"""``gcd-mcp``: a server of the Model Context Protocol, through which agents draw, check, drape, score and export.

``tools`` has the tools, ``server`` runs each call in a process of its own and answers with its text and picture.
"""
