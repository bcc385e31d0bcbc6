/* complete.c - completion of commands, options and their values in bash and zsh, from the tables of options. */
#include "cli.h"

#include <string.h>

/* Words that an option accepts, separated by blanks; 0: any value, so file names are offered. */
static int complete_choices(const oxl_option *o, char out[200])
{
    size_t n = 0;
    if (o->kind != OXL_OPTION_CHOICE && o->kind != OXL_OPTION_PRESET) return 0;
    for (const char *at = o->value; *at && n + 1 < 200; at++) out[n++] = *at == '|' ? ' ' : *at;
    out[n] = 0;
    return 1;
}

static void complete_bash_command(FILE *to, const struct cli_command *c)
{
    char word[40], choices[200];
    fprintf(to, "    %s)\n        case $prev in\n", c->name);
    for (int i = 0; i < cli_option_count(); i++) {
        const oxl_option *o = cli_option_at(i);
        if (!cli_option_is_of(i, c->command) || !complete_choices(o, choices)) continue;
        fprintf(to, "        %s) COMPREPLY=($(compgen -W '%s' -- \"$cur\")); return ;;\n", cli_option_word(o, word), choices);
    }
    fputs("        esac\n        words='", to);
    for (int i = 0; i < cli_option_count(); i++)
        if (cli_option_is_of(i, c->command)) fprintf(to, " %s", cli_option_word(cli_option_at(i), word));
    fputs("' ;;\n", to);
}

static void complete_bash(FILE *to)
{
    fputs("# bash completion of oceanxl; made by: oceanxl --completion bash\n"
          "_oceanxl() {\n"
          "    local cur=${COMP_WORDS[COMP_CWORD]} prev=${COMP_WORDS[COMP_CWORD-1]} words=\n"
          "    if [ \"$COMP_CWORD\" = 1 ]; then\n"
          "        COMPREPLY=($(compgen -W '",
          to);
    for (int i = 0; cli_command_at(i); i++) fprintf(to, "%s ", cli_command_at(i)->name);
    fputs("--help --version' -- \"$cur\"))\n        return\n    fi\n    case ${COMP_WORDS[1]} in\n", to);
    for (int i = 0; cli_command_at(i); i++) complete_bash_command(to, cli_command_at(i));
    fputs("    esac\n"
          "    case $cur in -*) COMPREPLY=($(compgen -W \"$words\" -- \"$cur\")) ;; esac\n"
          "}\n"
          "complete -o default -F _oceanxl oceanxl\n",
          to);
}

/* Inside single quotes, where _arguments gives brackets and colons a meaning. */
static void complete_zsh_text(FILE *to, const char *text)
{
    for (; *text && *text != '\n'; text++) {
        if (*text == '\'') fputs("'\\'", to);
        if (strchr("[]:\\", *text)) fputc('\\', to);
        fputc(*text, to);
    }
}

static void complete_zsh_option(FILE *to, const oxl_option *o)
{
    char word[40], choices[200];
    fprintf(to, " \\\n            '%s[", cli_option_word(o, word));
    complete_zsh_text(to, o->help);
    fputc(']', to);
    if (o->value) {
        fputc(':', to);
        complete_zsh_text(to, o->value);
        if (complete_choices(o, choices)) fprintf(to, ":(%s)", choices);
        else fputs(":_files", to);
    }
    fputc('\'', to);
}

static void complete_zsh(FILE *to)
{
    fputs("#compdef oceanxl\n# zsh completion of oceanxl; made by: oceanxl --completion zsh\n"
          "local -a commands\ncommands=(\n",
          to);
    for (int i = 0; cli_command_at(i); i++) {
        fprintf(to, "    '%s:", cli_command_at(i)->name);
        complete_zsh_text(to, cli_command_at(i)->purpose);
        fputs("'\n", to);
    }
    fputs(")\nif (( CURRENT == 2 )); then\n    _describe command commands\nelse\n    case $words[2] in\n", to);
    for (int i = 0; cli_command_at(i); i++) {
        fprintf(to, "    %s)\n        _arguments '1: :' '*:file:_files'", cli_command_at(i)->name);
        for (int k = 0; k < cli_option_count(); k++)
            if (cli_option_is_of(k, cli_command_at(i)->command)) complete_zsh_option(to, cli_option_at(k));
        fputs(" ;;\n", to);
    }
    fputs("    esac\nfi\n", to);
}

int complete_print(FILE *to, const char *shell)
{
    if (strcmp(shell, "bash") == 0) complete_bash(to);
    else if (strcmp(shell, "zsh") == 0) complete_zsh(to);
    else return 1;
    return 0;
}
