"""What the laboratory shows: matplotlib figures, Rerun scenes, one-file HTML reports. Nothing else imports this room."""
