"""What an organ is and how it was made, for people and other programs: report, info, export."""
