"""What pictures say of surfaces."""
