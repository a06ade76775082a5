"""A protocol that a third party registers: ten registers, one line a request, over TCP or in UDP datagrams.

======================  ==============================================
``R address``           read; answered by ``V address value``
``W address value``     write; answered by ``K address value``
anything else           answered by ``E``
======================  ==============================================
"""
