"""Data sets on servers: read sample by sample, downloaded, and published.

Nothing here is imported, and no server asked, before a URL or a repository is named.
"""
