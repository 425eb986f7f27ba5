"""Who is who after a blind region?"""
