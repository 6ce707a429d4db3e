"""What an organ is and how it was made, for users and for other programs: report, info, export."""
