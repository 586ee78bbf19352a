"""Data sets on servers: whole verified shards in the cache, single samples by range, downloads, publishing.

A server is contacted, and its libraries are imported, only when a URL or a repository is given.
"""
