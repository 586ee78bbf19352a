"""Data sets on servers: reading sample by sample, downloading, publishing, and generating into object stores.

This package is imported, and a server contacted, only when a URL or a repository is given.
"""
