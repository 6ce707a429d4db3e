"""What goes out: markers, contacts, diagnostics, transforms."""
