/* complete.c - completion of commands, options and their values in bash, and in zsh by its bashcompinit; from the tables of options. */
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

static void complete_command(FILE *to, enum command command)
{
    char word[40], choices[200];
    fprintf(to, "    %s)\n        case $prev in\n", CLI_COMMANDS[command].name);
    for (int i = 0; i < cli_option_count(); i++) {
        const oxl_option *o = cli_option_at(i);
        if (!cli_option_is_of(i, command) || !complete_choices(o, choices)) continue;
        fprintf(to, "        %s) COMPREPLY=($(compgen -W '%s' -- \"$cur\")); return ;;\n", cli_option_word(o, word), choices);
    }
    fputs("        esac\n        words='", to);
    for (int i = 0; i < cli_option_count(); i++)
        if (cli_option_is_of(i, command)) fprintf(to, " %s", cli_option_word(cli_option_at(i), word));
    fputs("' ;;\n", to);
}

void complete_print(FILE *to)
{
    fputs(
        "# completion of oceanxl in bash and zsh; made by: oceanxl --completion\n"
        "[ -z \"$ZSH_VERSION\" ] || { autoload -U compinit bashcompinit; whence compdef >/dev/null || compinit; bashcompinit; }\n"
        "_oceanxl() {\n"
        "    local cur=${COMP_WORDS[COMP_CWORD]} prev=${COMP_WORDS[COMP_CWORD-1]} words=\n"
        "    if [ \"$COMP_CWORD\" = 1 ]; then\n"
        "        COMPREPLY=($(compgen -W '",
        to);
    for (int i = 1; i < COMMANDS; i++) fprintf(to, "%s ", CLI_COMMANDS[i].name);
    fputs("--help --version' -- \"$cur\"))\n        return\n    fi\n    case ${COMP_WORDS[1]} in\n", to);
    for (enum command i = COMMAND_TRAIN; i < COMMANDS; i++) complete_command(to, i);
    fputs("    esac\n"
          "    case $cur in -*) COMPREPLY=($(compgen -W \"$words\" -- \"$cur\")) ;; esac\n"
          "}\n"
          "complete -o default -F _oceanxl oceanxl\n",
          to);
}
