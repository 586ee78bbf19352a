"""Make garments: body, measures, design, pattern, box mesh, drape."""
