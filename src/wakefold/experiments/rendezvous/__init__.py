"""Which activity do two boats take part in?"""
